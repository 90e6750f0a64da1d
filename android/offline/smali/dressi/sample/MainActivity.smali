.class public final Ldressi/sample/MainActivity;
.super Landroid/app/Activity;

# interfaces
.implements Ldressi/sample/Worker$Listener;


# instance fields
.field private choice:Landroid/widget/Spinner;

.field private curve:Ldressi/sample/CurveView;

.field private paused:Z

.field private picture:Landroid/widget/ImageView;

.field private final screen:Landroid/os/Handler;

.field private status:Landroid/widget/TextView;

.field private target:Landroid/widget/ImageView;

.field private worker:Ldressi/sample/Worker;


# direct methods
.method public constructor <init>()V
    .registers 3

    invoke-direct {p0}, Landroid/app/Activity;-><init>()V

    new-instance v0, Landroid/os/Handler;

    invoke-static {}, Landroid/os/Looper;->getMainLooper()Landroid/os/Looper;

    move-result-object v1

    invoke-direct {v0, v1}, Landroid/os/Handler;-><init>(Landroid/os/Looper;)V

    iput-object v0, p0, Ldressi/sample/MainActivity;->screen:Landroid/os/Handler;

    return-void
.end method

.method static synthetic access$000(Ldressi/sample/MainActivity;)Z
    .registers 2

    iget-boolean v0, p0, Ldressi/sample/MainActivity;->paused:Z

    return v0
.end method

.method static synthetic access$002(Ldressi/sample/MainActivity;Z)Z
    .registers 2

    iput-boolean p1, p0, Ldressi/sample/MainActivity;->paused:Z

    return p1
.end method

.method static synthetic access$100(Ldressi/sample/MainActivity;)Ldressi/sample/Worker;
    .registers 2

    iget-object v0, p0, Ldressi/sample/MainActivity;->worker:Ldressi/sample/Worker;

    return-object v0
.end method

.method static synthetic access$200(Ldressi/sample/MainActivity;Z)V
    .registers 2

    invoke-direct {p0, p1}, Ldressi/sample/MainActivity;->restart(Z)V

    return-void
.end method

.method static synthetic access$300(Ldressi/sample/MainActivity;)V
    .registers 1

    invoke-direct {p0}, Ldressi/sample/MainActivity;->capture()V

    return-void
.end method

.method static synthetic access$400(Ldressi/sample/MainActivity;)Landroid/os/Handler;
    .registers 2

    iget-object v0, p0, Ldressi/sample/MainActivity;->screen:Landroid/os/Handler;

    return-object v0
.end method

.method static synthetic access$500(Ldressi/sample/MainActivity;)Landroid/widget/ImageView;
    .registers 2

    iget-object v0, p0, Ldressi/sample/MainActivity;->target:Landroid/widget/ImageView;

    return-object v0
.end method

.method static synthetic access$600(Ldressi/sample/MainActivity;)Landroid/widget/ImageView;
    .registers 2

    iget-object v0, p0, Ldressi/sample/MainActivity;->picture:Landroid/widget/ImageView;

    return-object v0
.end method

.method static synthetic access$700(Ldressi/sample/MainActivity;)Ldressi/sample/CurveView;
    .registers 2

    iget-object v0, p0, Ldressi/sample/MainActivity;->curve:Ldressi/sample/CurveView;

    return-object v0
.end method

.method static synthetic access$800(Ldressi/sample/MainActivity;)Landroid/widget/TextView;
    .registers 2

    iget-object v0, p0, Ldressi/sample/MainActivity;->status:Landroid/widget/TextView;

    return-object v0
.end method

.method private bundles()Ljava/util/List;
    .registers 7
    .annotation system Ldalvik/annotation/Signature;
        value = {
            "()",
            "Ljava/util/List",
            "<",
            "Ljava/lang/String;",
            ">;"
        }
    .end annotation

    new-instance v1, Ljava/util/ArrayList;

    invoke-direct {v1}, Ljava/util/ArrayList;-><init>()V

    :try_start_5
    invoke-virtual {p0}, Ldressi/sample/MainActivity;->getAssets()Landroid/content/res/AssetManager;

    move-result-object v0

    const-string v2, ""

    invoke-virtual {v0, v2}, Landroid/content/res/AssetManager;->list(Ljava/lang/String;)[Ljava/lang/String;

    move-result-object v2

    array-length v3, v2

    const/4 v0, 0x0

    :goto_11
    if-ge v0, v3, :cond_24

    aget-object v4, v2, v0

    const-string v5, ".dressi"

    invoke-virtual {v4, v5}, Ljava/lang/String;->endsWith(Ljava/lang/String;)Z

    move-result v5

    if-eqz v5, :cond_20

    invoke-interface {v1, v4}, Ljava/util/List;->add(Ljava/lang/Object;)Z
    :try_end_20
    .catch Ljava/io/IOException; {:try_start_5 .. :try_end_20} :catch_23

    :cond_20
    add-int/lit8 v0, v0, 0x1

    goto :goto_11

    :catch_23
    move-exception v0

    :cond_24
    return-object v1
.end method

.method private button(Landroid/widget/LinearLayout;Ljava/lang/String;Landroid/view/View$OnClickListener;)V
    .registers 9

    new-instance v0, Landroid/widget/Button;

    invoke-direct {v0, p0}, Landroid/widget/Button;-><init>(Landroid/content/Context;)V

    invoke-virtual {v0, p2}, Landroid/widget/Button;->setText(Ljava/lang/CharSequence;)V

    invoke-virtual {v0, p3}, Landroid/widget/Button;->setOnClickListener(Landroid/view/View$OnClickListener;)V

    new-instance v1, Landroid/widget/LinearLayout$LayoutParams;

    const/4 v2, 0x0

    const/4 v3, -0x2

    const/high16 v4, 0x3f800000    # 1.0f

    invoke-direct {v1, v2, v3, v4}, Landroid/widget/LinearLayout$LayoutParams;-><init>(IIF)V

    invoke-virtual {p1, v0, v1}, Landroid/widget/LinearLayout;->addView(Landroid/view/View;Landroid/view/ViewGroup$LayoutParams;)V

    return-void
.end method

.method private capture()V
    .registers 5

    new-instance v0, Ljava/io/File;

    const/4 v1, 0x0

    invoke-virtual {p0, v1}, Ldressi/sample/MainActivity;->getExternalFilesDir(Ljava/lang/String;)Ljava/io/File;

    move-result-object v1

    const-string v2, "profile.json"

    invoke-direct {v0, v1, v2}, Ljava/io/File;-><init>(Ljava/io/File;Ljava/lang/String;)V

    new-instance v1, Ljava/text/SimpleDateFormat;

    const-string v2, "yyyy-MM-dd"

    sget-object v3, Ljava/util/Locale;->ROOT:Ljava/util/Locale;

    invoke-direct {v1, v2, v3}, Ljava/text/SimpleDateFormat;-><init>(Ljava/lang/String;Ljava/util/Locale;)V

    new-instance v2, Ljava/util/Date;

    invoke-direct {v2}, Ljava/util/Date;-><init>()V

    invoke-virtual {v1, v2}, Ljava/text/SimpleDateFormat;->format(Ljava/util/Date;)Ljava/lang/String;

    move-result-object v1

    new-instance v2, Ldressi/sample/MainActivity$6;

    const-string v3, "dressi profile"

    invoke-direct {v2, p0, v3, v0, v1}, Ldressi/sample/MainActivity$6;-><init>(Ldressi/sample/MainActivity;Ljava/lang/String;Ljava/io/File;Ljava/lang/String;)V

    invoke-virtual {v2}, Ldressi/sample/MainActivity$6;->start()V

    return-void
.end method

.method private column()Landroid/widget/LinearLayout;
    .registers 3

    const/4 v1, 0x1

    new-instance v0, Landroid/widget/LinearLayout;

    invoke-direct {v0, p0}, Landroid/widget/LinearLayout;-><init>(Landroid/content/Context;)V

    invoke-virtual {v0, v1}, Landroid/widget/LinearLayout;->setOrientation(I)V

    invoke-virtual {v0, v1}, Landroid/widget/LinearLayout;->setGravity(I)V

    return-object v0
.end method

.method private dp(I)I
    .registers 4

    int-to-float v0, p1

    invoke-virtual {p0}, Ldressi/sample/MainActivity;->getResources()Landroid/content/res/Resources;

    move-result-object v1

    invoke-virtual {v1}, Landroid/content/res/Resources;->getDisplayMetrics()Landroid/util/DisplayMetrics;

    move-result-object v1

    iget v1, v1, Landroid/util/DisplayMetrics;->density:F

    mul-float/2addr v0, v1

    invoke-static {v0}, Ljava/lang/Math;->round(F)I

    move-result v0

    return v0
.end method

.method private picture(Landroid/widget/LinearLayout;)Landroid/widget/ImageView;
    .registers 7

    new-instance v0, Landroid/widget/ImageView;

    invoke-direct {v0, p0}, Landroid/widget/ImageView;-><init>(Landroid/content/Context;)V

    const/4 v1, 0x1

    invoke-virtual {v0, v1}, Landroid/widget/ImageView;->setAdjustViewBounds(Z)V

    sget-object v1, Landroid/widget/ImageView$ScaleType;->FIT_CENTER:Landroid/widget/ImageView$ScaleType;

    invoke-virtual {v0, v1}, Landroid/widget/ImageView;->setScaleType(Landroid/widget/ImageView$ScaleType;)V

    new-instance v1, Landroid/widget/LinearLayout$LayoutParams;

    const/4 v2, 0x0

    const/16 v3, 0xb4

    invoke-direct {p0, v3}, Ldressi/sample/MainActivity;->dp(I)I

    move-result v3

    const/high16 v4, 0x3f800000    # 1.0f

    invoke-direct {v1, v2, v3, v4}, Landroid/widget/LinearLayout$LayoutParams;-><init>(IIF)V

    invoke-virtual {p1, v0, v1}, Landroid/widget/LinearLayout;->addView(Landroid/view/View;Landroid/view/ViewGroup$LayoutParams;)V

    return-object v0
.end method

.method private restart(Z)V
    .registers 8

    iget-object v0, p0, Ldressi/sample/MainActivity;->worker:Ldressi/sample/Worker;

    if-eqz v0, :cond_9

    iget-object v0, p0, Ldressi/sample/MainActivity;->worker:Ldressi/sample/Worker;

    invoke-virtual {v0}, Ldressi/sample/Worker;->finish()V

    :cond_9
    const/4 v0, 0x0

    iput-object v0, p0, Ldressi/sample/MainActivity;->worker:Ldressi/sample/Worker;

    iget-object v0, p0, Ldressi/sample/MainActivity;->curve:Ldressi/sample/CurveView;

    invoke-virtual {v0}, Ldressi/sample/CurveView;->clear()V

    iget-object v0, p0, Ldressi/sample/MainActivity;->choice:Landroid/widget/Spinner;

    invoke-virtual {v0}, Landroid/widget/Spinner;->getSelectedItem()Ljava/lang/Object;

    move-result-object v1

    if-nez v1, :cond_21

    iget-object v0, p0, Ldressi/sample/MainActivity;->status:Landroid/widget/TextView;

    const-string v1, "There is no .dressi file in the assets."

    invoke-virtual {v0, v1}, Landroid/widget/TextView;->setText(Ljava/lang/CharSequence;)V

    :goto_20
    return-void

    :cond_21
    new-instance v0, Ldressi/sample/Worker;

    invoke-virtual {v1}, Ljava/lang/Object;->toString()Ljava/lang/String;

    move-result-object v2

    iget-boolean v4, p0, Ldressi/sample/MainActivity;->paused:Z

    move-object v1, p0

    move v3, p1

    move-object v5, p0

    invoke-direct/range {v0 .. v5}, Ldressi/sample/Worker;-><init>(Landroid/content/Context;Ljava/lang/String;ZZLdressi/sample/Worker$Listener;)V

    iput-object v0, p0, Ldressi/sample/MainActivity;->worker:Ldressi/sample/Worker;

    iget-object v0, p0, Ldressi/sample/MainActivity;->worker:Ldressi/sample/Worker;

    invoke-virtual {v0}, Ldressi/sample/Worker;->start()V

    goto :goto_20
.end method


# virtual methods
.method protected onCreate(Landroid/os/Bundle;)V
    .registers 9

    const/4 v1, 0x0

    const/16 v6, 0x8

    invoke-super {p0, p1}, Landroid/app/Activity;->onCreate(Landroid/os/Bundle;)V

    if-eqz p1, :cond_c4

    const-string v0, "paused"

    invoke-virtual {p1, v0}, Landroid/os/Bundle;->getBoolean(Ljava/lang/String;)Z

    move-result v0

    if-eqz v0, :cond_c4

    const/4 v0, 0x1

    :goto_11
    iput-boolean v0, p0, Ldressi/sample/MainActivity;->paused:Z

    invoke-direct {p0}, Ldressi/sample/MainActivity;->column()Landroid/widget/LinearLayout;

    move-result-object v0

    new-instance v2, Landroid/widget/Spinner;

    invoke-direct {v2, p0}, Landroid/widget/Spinner;-><init>(Landroid/content/Context;)V

    iput-object v2, p0, Ldressi/sample/MainActivity;->choice:Landroid/widget/Spinner;

    iget-object v2, p0, Ldressi/sample/MainActivity;->choice:Landroid/widget/Spinner;

    new-instance v3, Landroid/widget/ArrayAdapter;

    const v4, 0x1090009

    invoke-direct {p0}, Ldressi/sample/MainActivity;->bundles()Ljava/util/List;

    move-result-object v5

    invoke-direct {v3, p0, v4, v5}, Landroid/widget/ArrayAdapter;-><init>(Landroid/content/Context;ILjava/util/List;)V

    invoke-virtual {v2, v3}, Landroid/widget/Spinner;->setAdapter(Landroid/widget/SpinnerAdapter;)V

    iget-object v2, p0, Ldressi/sample/MainActivity;->choice:Landroid/widget/Spinner;

    invoke-virtual {v0, v2}, Landroid/widget/LinearLayout;->addView(Landroid/view/View;)V

    new-instance v2, Landroid/widget/LinearLayout;

    invoke-direct {v2, p0}, Landroid/widget/LinearLayout;-><init>(Landroid/content/Context;)V

    invoke-direct {p0, v2}, Ldressi/sample/MainActivity;->picture(Landroid/widget/LinearLayout;)Landroid/widget/ImageView;

    move-result-object v3

    iput-object v3, p0, Ldressi/sample/MainActivity;->target:Landroid/widget/ImageView;

    invoke-direct {p0, v2}, Ldressi/sample/MainActivity;->picture(Landroid/widget/LinearLayout;)Landroid/widget/ImageView;

    move-result-object v3

    iput-object v3, p0, Ldressi/sample/MainActivity;->picture:Landroid/widget/ImageView;

    invoke-virtual {v0, v2}, Landroid/widget/LinearLayout;->addView(Landroid/view/View;)V

    new-instance v2, Ldressi/sample/CurveView;

    invoke-direct {v2, p0}, Ldressi/sample/CurveView;-><init>(Landroid/content/Context;)V

    iput-object v2, p0, Ldressi/sample/MainActivity;->curve:Ldressi/sample/CurveView;

    iget-object v2, p0, Ldressi/sample/MainActivity;->curve:Ldressi/sample/CurveView;

    new-instance v3, Landroid/widget/LinearLayout$LayoutParams;

    const/4 v4, -0x1

    const/16 v5, 0x78

    invoke-direct {p0, v5}, Ldressi/sample/MainActivity;->dp(I)I

    move-result v5

    invoke-direct {v3, v4, v5}, Landroid/widget/LinearLayout$LayoutParams;-><init>(II)V

    invoke-virtual {v0, v2, v3}, Landroid/widget/LinearLayout;->addView(Landroid/view/View;Landroid/view/ViewGroup$LayoutParams;)V

    new-instance v2, Landroid/widget/LinearLayout;

    invoke-direct {v2, p0}, Landroid/widget/LinearLayout;-><init>(Landroid/content/Context;)V

    const-string v3, "Pause / go on"

    new-instance v4, Ldressi/sample/MainActivity$1;

    invoke-direct {v4, p0}, Ldressi/sample/MainActivity$1;-><init>(Ldressi/sample/MainActivity;)V

    invoke-direct {p0, v2, v3, v4}, Ldressi/sample/MainActivity;->button(Landroid/widget/LinearLayout;Ljava/lang/String;Landroid/view/View$OnClickListener;)V

    const-string v3, "Other pictures"

    new-instance v4, Ldressi/sample/MainActivity$2;

    invoke-direct {v4, p0}, Ldressi/sample/MainActivity$2;-><init>(Ldressi/sample/MainActivity;)V

    invoke-direct {p0, v2, v3, v4}, Ldressi/sample/MainActivity;->button(Landroid/widget/LinearLayout;Ljava/lang/String;Landroid/view/View$OnClickListener;)V

    const-string v3, "Begin again"

    new-instance v4, Ldressi/sample/MainActivity$3;

    invoke-direct {v4, p0}, Ldressi/sample/MainActivity$3;-><init>(Ldressi/sample/MainActivity;)V

    invoke-direct {p0, v2, v3, v4}, Ldressi/sample/MainActivity;->button(Landroid/widget/LinearLayout;Ljava/lang/String;Landroid/view/View$OnClickListener;)V

    const-string v3, "Profile"

    new-instance v4, Ldressi/sample/MainActivity$4;

    invoke-direct {v4, p0}, Ldressi/sample/MainActivity$4;-><init>(Ldressi/sample/MainActivity;)V

    invoke-direct {p0, v2, v3, v4}, Ldressi/sample/MainActivity;->button(Landroid/widget/LinearLayout;Ljava/lang/String;Landroid/view/View$OnClickListener;)V

    invoke-virtual {v0, v2}, Landroid/widget/LinearLayout;->addView(Landroid/view/View;)V

    new-instance v2, Landroid/widget/TextView;

    invoke-direct {v2, p0}, Landroid/widget/TextView;-><init>(Landroid/content/Context;)V

    iput-object v2, p0, Ldressi/sample/MainActivity;->status:Landroid/widget/TextView;

    iget-object v2, p0, Ldressi/sample/MainActivity;->status:Landroid/widget/TextView;

    invoke-direct {p0, v6}, Ldressi/sample/MainActivity;->dp(I)I

    move-result v3

    invoke-direct {p0, v6}, Ldressi/sample/MainActivity;->dp(I)I

    move-result v4

    invoke-direct {p0, v6}, Ldressi/sample/MainActivity;->dp(I)I

    move-result v5

    invoke-direct {p0, v6}, Ldressi/sample/MainActivity;->dp(I)I

    move-result v6

    invoke-virtual {v2, v3, v4, v5, v6}, Landroid/widget/TextView;->setPadding(IIII)V

    iget-object v2, p0, Ldressi/sample/MainActivity;->status:Landroid/widget/TextView;

    invoke-virtual {v0, v2}, Landroid/widget/LinearLayout;->addView(Landroid/view/View;)V

    new-instance v2, Landroid/widget/ScrollView;

    invoke-direct {v2, p0}, Landroid/widget/ScrollView;-><init>(Landroid/content/Context;)V

    invoke-virtual {v2, v0}, Landroid/widget/ScrollView;->addView(Landroid/view/View;)V

    invoke-virtual {p0, v2}, Ldressi/sample/MainActivity;->setContentView(Landroid/view/View;)V

    iget-object v0, p0, Ldressi/sample/MainActivity;->choice:Landroid/widget/Spinner;

    if-nez p1, :cond_c7

    :goto_c0
    invoke-virtual {v0, v1}, Landroid/widget/Spinner;->setSelection(I)V

    return-void

    :cond_c4
    move v0, v1

    goto/16 :goto_11

    :cond_c7
    const-string v1, "choice"

    invoke-virtual {p1, v1}, Landroid/os/Bundle;->getInt(Ljava/lang/String;)I

    move-result v1

    goto :goto_c0
.end method

.method public onProgress(Ldressi/sample/Worker;Landroid/graphics/Bitmap;Landroid/graphics/Bitmap;FLjava/lang/String;)V
    .registers 14

    iget-object v7, p0, Ldressi/sample/MainActivity;->screen:Landroid/os/Handler;

    new-instance v0, Ldressi/sample/MainActivity$7;

    move-object v1, p0

    move-object v2, p1

    move-object v3, p2

    move-object v4, p3

    move v5, p4

    move-object v6, p5

    invoke-direct/range {v0 .. v6}, Ldressi/sample/MainActivity$7;-><init>(Ldressi/sample/MainActivity;Ldressi/sample/Worker;Landroid/graphics/Bitmap;Landroid/graphics/Bitmap;FLjava/lang/String;)V

    invoke-virtual {v7, v0}, Landroid/os/Handler;->post(Ljava/lang/Runnable;)Z

    return-void
.end method

.method protected onSaveInstanceState(Landroid/os/Bundle;)V
    .registers 4

    invoke-super {p0, p1}, Landroid/app/Activity;->onSaveInstanceState(Landroid/os/Bundle;)V

    const-string v0, "choice"

    iget-object v1, p0, Ldressi/sample/MainActivity;->choice:Landroid/widget/Spinner;

    invoke-virtual {v1}, Landroid/widget/Spinner;->getSelectedItemPosition()I

    move-result v1

    invoke-virtual {p1, v0, v1}, Landroid/os/Bundle;->putInt(Ljava/lang/String;I)V

    const-string v0, "paused"

    iget-boolean v1, p0, Ldressi/sample/MainActivity;->paused:Z

    invoke-virtual {p1, v0, v1}, Landroid/os/Bundle;->putBoolean(Ljava/lang/String;Z)V

    return-void
.end method

.method protected onStart()V
    .registers 3

    invoke-super {p0}, Landroid/app/Activity;->onStart()V

    iget-object v0, p0, Ldressi/sample/MainActivity;->choice:Landroid/widget/Spinner;

    new-instance v1, Ldressi/sample/MainActivity$5;

    invoke-direct {v1, p0}, Ldressi/sample/MainActivity$5;-><init>(Ldressi/sample/MainActivity;)V

    invoke-virtual {v0, v1}, Landroid/widget/Spinner;->setOnItemSelectedListener(Landroid/widget/AdapterView$OnItemSelectedListener;)V

    return-void
.end method

.method protected onStop()V
    .registers 3

    const/4 v1, 0x0

    iget-object v0, p0, Ldressi/sample/MainActivity;->choice:Landroid/widget/Spinner;

    invoke-virtual {v0, v1}, Landroid/widget/Spinner;->setOnItemSelectedListener(Landroid/widget/AdapterView$OnItemSelectedListener;)V

    iget-object v0, p0, Ldressi/sample/MainActivity;->worker:Ldressi/sample/Worker;

    if-eqz v0, :cond_f

    iget-object v0, p0, Ldressi/sample/MainActivity;->worker:Ldressi/sample/Worker;

    invoke-virtual {v0}, Ldressi/sample/Worker;->finish()V

    :cond_f
    iput-object v1, p0, Ldressi/sample/MainActivity;->worker:Ldressi/sample/Worker;

    invoke-super {p0}, Landroid/app/Activity;->onStop()V

    return-void
.end method
